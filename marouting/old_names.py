"""Names of options before version 0.3, and messages about keys that are not known."""

import difflib
import textwrap
from collections.abc import Sequence

_LISTED = 280  # the most characters of a list of known keys


RENAMED_VALUES = {"chance": "random", "own": "local", "price": "history", "ways": "greedy"}
"""Values of options before version 0.3, and what they are called now."""

_PRICES = "train.negotiation of a training: only the generalist negotiates by prices"

RENAMED = {
    "rip_up_calm": _PRICES,
    "rip_up_patience": _PRICES,
    "rip_up_present": _PRICES,
    "rip_up_prices": _PRICES,
    "copies": "num_envs",
    "give_back": "release_failed",
    "helped": "expert_moves",
    "mind": "policy: network, greedy or random",
    "next_task": "next_pin",
    "taught": "expert_fraction",
    "warmth": "temperature",
    "net_order": "nets: {order: …}",
    "decomposition": "nets: {decomposition: …}",
    "mask_visited": "mask: {visited: …}",
    "mask_in_observation": "mask: {in_observation: …}",
    "observation_key": "mask: {observation_key: …}",
    "mask_key": "mask: {mask_key: …}",
    "rip_up_rounds": "rip_up: {rounds: …}",
    "rip_up_neighbours": "rip_up: {neighbours: …}",
    "present": "present_factor",
    "growth": "present_growth",
    "history": "history_increment",
    "decay": "history_decay",
    "calm": "step_decay",
    "stuck": "stall_passes",
    "least_fall": "min_overflow_drop",
    "least_gain": "min_wirelength_gain",
    "again": "reroute_fraction",
    "probe": "lp_after_pass",
    "priced": "lp_passes",
    "worth": "lp_price_scale",
    "patience": "repair_after",
    "worse": "overflow_stall_weight",
    "repairs": "repair_stall_passes",
    "least_repaired": "min_repair_fraction",
    "persistence": "patience_factor",
}
"""Names that keys had before version 0.3, and what they are called now."""

REMOVED = {
    "importance_exponent": "prioritised replay",
    "n_step": "returns of n steps",
    "prioritised": "prioritised replay",
    "priority_exponent": "prioritised replay",
}
"""Keys that version 0.3 removed without a replacement, and what they were for."""


def unknown_key(
    key: str, known: Sequence[str], component: str = "", also: Sequence[str] = ()
) -> str:
    """The message about a key that is not one of those known, perhaps of a component.

    ``also`` are other keys that may have been meant.
    """
    name = key.rpartition(".")[2]
    new = RENAMED.get(name)
    if new and (new == _PRICES or new.partition(":")[0] in known):
        return f"{key}: unknown key; it is now {new}"
    if name in REMOVED:
        return f"{key}: unknown key; version 0.3 removed {REMOVED[name]}"
    close = difflib.get_close_matches(name, [*known, *also], n=1, cutoff=0.5)
    # What follows must not lie in the middle of a long message, which is left out.
    listed = textwrap.shorten(", ".join(known), _LISTED, placeholder=" …")
    listed = (f"one of {listed}" if known else "none") + (f" for {component}" if component else "")
    expected = f"did you mean {close[0]}?" if close else f"expected {listed}"
    return f"{key}: unknown key; {expected}"
