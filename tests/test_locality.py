"""Observations that say how far agents see, and the check that holds them to it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from conftest import examples
from gymnasium.spaces import Box
from hypothesis import given
from hypothesis import strategies as st
from reference import contested

import marouting
from marouting import Engine, InputError, PaperObservation, Problem, WindowObservation, generate
from marouting.batch.locality import check_local
from marouting.batch.window import CHANNELS
from marouting.observations import local_radius_of
from policies.generalist.outlook import OutlookObservation

LOCAL = tuple(channel for channel in CHANNELS if channel != "demand")

local = st.one_of(
    st.just(PaperObservation()),
    st.builds(
        WindowObservation,
        st.integers(0, 2),
        st.integers(0, 1),
        st.lists(st.sampled_from(LOCAL), unique=True, min_size=1).map(tuple),
    ),
)

rules = st.fixed_dictionaries(
    {
        "overflow": st.sampled_from(["forbidden", "allowed"]),
        "target": st.sampled_from(["pin", "tree"]),
        "next_pin": st.sampled_from(["listed", "nearest"]),
        "release_failed": st.booleans(),
        "rip_up": st.sampled_from([None, {"rounds": 2, "choose": "history"}]),
        "mask": st.fixed_dictionaries({"visited": st.booleans()}),
        "message_bits": st.just(1),
    }
)


def played(problems: list[Problem], moves: int, seed: int, **options: Any) -> Engine:
    """Games in which everybody has made some random moves."""
    engine = Engine(problems, turn_order="round_robin", max_steps=9, **options)
    rng = np.random.default_rng(seed)
    for _ in range(moves):
        engine.step(rng.integers(0, engine.actions, engine.nets.shape))
    return engine


@examples(25)
@given(contested(max_nets=5), local, rules, st.integers(0, 30), st.integers(0, 1000))
def test_local_observations_keep_to_their_radius(
    problem: Problem, observation: Any, rules: dict[str, Any], moves: int, seed: int
) -> None:
    engine = played([problem, problem], moves, seed, **rules)
    before = engine.save()
    check_local(observation, engine, seed=seed)
    for name, array in engine.dynamic._asdict().items():
        np.testing.assert_array_equal(array, getattr(before, name), err_msg=name)
    assert engine.problems == (problem, problem)


class Crowd(PaperObservation):
    """The paper's numbers, and one that is not the agent's to see."""

    def __init__(self, seen: str) -> None:
        super().__init__()
        self.seen = seen

    def space(self, problems: Any, overflow: bool) -> Box:
        del problems, overflow
        return Box(-np.inf, np.inf, (13,), np.float32)

    def write(self, games: Any, problems: Any, agents: Any, out: Any) -> None:
        super().write(games, problems, agents, out[:, :12])
        if self.seen == "active":
            out[:, 12] = games.games["active"][problems]
        elif self.seen == "targets":
            out[:, 12] = games.agents["target"].sum(axis=1)[problems]
        elif self.seen == "pins":
            nets = [games.problems[m].nets for m in problems]
            out[:, 12] = [sum(pin.x for net in own for pin in net.pins) for own in nets]
        elif self.seen == "used":
            edges = np.arange(games.remaining.shape[1])
            for i, m in enumerate(problems):
                uses = [
                    games.uses(np.full_like(edges, m), np.full_like(edges, n), edges).sum()
                    for n in range(games.agents.shape[1])
                ]
                out[i, 12] = sum(uses)


@dataclass(frozen=True)
class Boasting(WindowObservation):
    """A window that says that it is smaller than it is."""

    @property
    def local_radius(self) -> int | None:
        return self.radius - 1


@dataclass(frozen=True)
class Modest(WindowObservation):
    """A window with all channels that says that it is local."""

    @property
    def local_radius(self) -> int | None:
        return self.radius


@pytest.mark.parametrize("seen", ["active", "targets", "pins", "used"])
def test_what_everybody_does_is_not_seen_from_one_place(seen: str) -> None:
    engine = played(generate(1, nets=8, seed=1), 5, 0)
    expected = r"^Crowd\.local_radius: expected agents to see no further than 0 Gcells; agent"
    with pytest.raises(InputError, match=expected):
        check_local(Crowd(seen), engine)


@pytest.mark.parametrize("channel", ["capacity", "heads", "history", "messages"])
def test_a_window_cannot_be_larger_than_it_says(channel: Any) -> None:
    rip_up = {"rounds": 1, "choose": "history"}
    engine = played(generate(1, nets=8, seed=1), 3, 0, rip_up=rip_up, message_bits=1)
    with pytest.raises(InputError, match=r"^Boasting\.local_radius: expected agents to see"):
        check_local(Boasting(2, 0, (channel,)), engine)


def test_predicted_demand_is_not_local() -> None:
    engine = played(generate(1, nets=8, seed=1), 3, 0)
    with pytest.raises(InputError, match=r"^Modest\.local_radius: expected agents to see"):
        check_local(Modest(2, 0, ("demand",)), engine)
    assert local_radius_of(WindowObservation(2, 0, ("capacity", "demand"))) is None
    assert local_radius_of(WindowObservation(2, 0, ("capacity",))) == 2
    assert local_radius_of(PaperObservation()) == 0
    assert local_radius_of(OutlookObservation()) is None


def test_only_so_much_is_allowed() -> None:
    engine = played(generate(1, nets=3, seed=1), 0, 0)
    check_local(WindowObservation(2, 0, ("capacity",)), engine, 2)
    with pytest.raises(InputError, match=r"local_radius: expected at most 1, found 2$"):
        check_local(WindowObservation(2, 0, ("capacity",)), engine, 1)
    with pytest.raises(InputError, match=r"expected a whole number, found None: agents may"):
        check_local(WindowObservation(2, 0), engine)


@pytest.mark.parametrize("radius", [-1, 1.5, "2"])
def test_a_radius_is_a_whole_number(radius: Any) -> None:
    observation: Any = PaperObservation()
    object.__setattr__(observation, "local_radius", radius)
    with pytest.raises(InputError, match=r"^PaperObservation\.local_radius: expected a whole"):
        marouting.observations.local_radius_of(observation)
