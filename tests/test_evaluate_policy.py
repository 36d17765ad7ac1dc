"""Policies scored on a split of a scenario: the figures are those of the routes that they made."""

from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from marouting import InputError, PaperObservation, evaluate, evaluate_policy, scenarios
from marouting.batch.window import WindowObservation
from marouting.evaluation import result_of
from marouting.options import game_options
from marouting.scenarios.score import Figures, score
from marouting.search.astar import sequential_astar
from marouting.vector import BatchEnv
from policies.experiment import anarchy
from policies.routers.local import LocalRouter


def first(obs: NDArray[np.float32], masks: NDArray[np.int8]) -> NDArray[np.int64]:
    """The first move that crosses an edge."""
    assert len(obs) == len(masks)
    return masks.argmax(axis=1)


def nearer(obs: NDArray[np.float32], masks: NDArray[np.int8]) -> NDArray[np.int64]:
    """Towards the target, by the paper's numbers."""
    away = obs[:, [3, 3, 4, 4, 5, 5]] * [1, -1, 1, -1, 1, -1]
    return np.where(masks, np.sign(away), -2).argmax(axis=1)


@pytest.mark.parametrize("order", ["round_robin", "sequential"])
def test_figures_are_those_of_the_routes(order: Any) -> None:
    toy = scenarios.get("toy-4x4-v0")
    options: dict[str, Any] = {"turn_order": order, "mask": {"visited": True}, "max_steps": 20}
    result = evaluate_policy(nearer, "toy-4x4-v0", "validation", **options)
    env = BatchEnv(toy.validation, play_once=True, **options)
    obs, info = env.reset()
    moves = 0
    while info["active"].any():
        actions = nearer(obs.reshape(-1, 12), info["action_mask"].reshape(-1, 6))
        obs, *_, info = env.step(actions.reshape(info["agents"].shape))
        moves += int(info["acted"].sum())
    assert result.agent_steps == moves
    assert [row.problem for row in result.rows] == list(toy.problems("validation"))
    costs, best, scores = [], 0, []
    for m, (problem, row) in enumerate(zip(toy.validation, result.rows, strict=True)):
        routes = evaluate(problem, env.engine.solution(m))
        assert (row.wirelength, row.overflow) == (routes.wirelength, routes.overflow)
        assert row.open == len(routes.disconnected)
        assert row.joined == info["joined"][m]
        costs.append(routes.wirelength + toy.open_cost * (row.tasks - row.joined))
        reference = toy.reference(problem)
        best += reference.wirelength
        astar = Figures.of(evaluate(problem, sequential_astar(problem)))
        scores.append(score(Figures.of(routes), astar, Figures(0, *reference[:2])))
        solved = not row.open and not row.overflow
        gap = 100 * (routes.wirelength / reference.wirelength - 1)
        assert row.gap == (pytest.approx(gap) if solved else None)
    assert result.cost == pytest.approx(sum(costs) / best)
    assert result.solved == np.mean([row.open == 0 for row in result.rows])
    assert 0 < result.solved < 1
    assert result.connected == sum(info["joined"]) / 5 / len(result.rows)
    assert result.score == pytest.approx(np.sort(scores)[5:-5].mean())
    assert result.compared == round(result.solved * 20)
    assert "toy-4x4-v0 validation: cost" in str(result)
    assert result.as_dict()["rows"][0]["problem"] == "validation_000"


def test_overflow_costs_as_much_as_open_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of policies, rules and references alike: 1 is as good as the references."""
    name = "tight-16x16-v0"
    tight = scenarios.get(name)
    best = [tight.reference(problem) for problem in tight.validation]
    over = sum(reference.overflow for reference in best)
    assert over > 0
    least = sum(reference.wirelength for reference in best) + tight.open_cost * over
    assert tight.reference_cost("validation") == least
    rules = game_options({"scenario": name, "split": "validation", "overflow": "allowed"}).rules
    monkeypatch.setattr(anarchy, "rules_of", lambda _: rules)
    rule = LocalRouter(radius=None)
    engine = rule.play(tight.validation, rules)
    found = result_of(engine, name, "validation")
    assert found.overflow > over
    assert found.connected == 1
    assert found.cost == (found.wirelength + tight.open_cost * found.overflow) / least
    row = anarchy.measure(tight, "validation", rule)
    assert row.cost == pytest.approx(found.cost, abs=1e-4)
    assert row.solved / row.problems == found.solved < 1


def test_options_are_those_of_the_environment() -> None:
    seen = set()

    def policy(obs: NDArray[np.float32], masks: NDArray[np.int8]) -> NDArray[np.int64]:
        seen.add(obs.shape[1:])
        return first(obs, masks)

    window = WindowObservation(radius=1)
    evaluate_policy(policy, "toy-4x4-v0", "validation", observation=window, max_steps=3)
    gates = evaluate_policy(policy, "gates-8x7-v0", "validation", local=3)
    assert gates.score == scenarios.get("gates-8x7-v0").score(gates.cost, "validation")
    suggested = scenarios.get("gates-8x7-v0").env["observation"]
    options = {name: value for name, value in suggested.items() if name != "kind"}
    assert seen == {
        one.space(scenarios.get("toy-4x4-v0").validation, overflow=False).shape
        for one in (window, WindowObservation(**options))
    }


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"rip_up": {"rounds": 2}}, "rip_up: expected None, as gates-8x7-v0 is played, found {'ro"),
        ({"overflow": "allowed"}, "overflow: expected forbidden, as gates-8x7-v0 is played, found"),
        ({"turn_order": "sequential"}, "turn_order: expected round_robin, as gates-8x7-v0 is pla"),
        ({"max_steps": 3}, "max_steps: expected None, as gates-8x7-v0 is played, found 3"),
        ({"mask": {"visited": False}}, "mask: expected {'visited': True}, as gates-8x7-v0 is pla"),
    ],
)
def test_scenarios_of_policies_have_one_game(options: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError) as caught:
        evaluate_policy(first, "gates-8x7-v0", "validation", **options)
    assert str(caught.value).startswith(expected)
    assert evaluate_policy(first, "toy-4x4-v0", "validation", **options).problems == 20


def test_what_policies_may_choose_in_the_game_of_a_scenario() -> None:
    options: dict[str, Any] = {"mask": {"visited": True}, "wait": True}
    found = evaluate_policy(first, "gates-8x7-v0", "validation", message_bits=1, **options)
    assert found.score == evaluate_policy(first, "gates-8x7-v0", "validation").score


def test_agents_decide_the_turn_order() -> None:
    rows = []

    def policy(obs: NDArray[np.float32], masks: NDArray[np.int8]) -> NDArray[np.int64]:
        rows.append(len(obs))
        return first(obs, masks)

    toy: Any = ("toy-4x4-v0", "validation")
    games = len(scenarios.get(toy[0]).validation)
    alone = evaluate_policy(policy, *toy, agents="single")
    assert max(rows) == games
    assert alone == evaluate_policy(first, *toy, turn_order="sequential")
    rows.clear()
    assert evaluate_policy(policy, *toy, agents="multi") == evaluate_policy(first, *toy)
    assert max(rows) > games
    with pytest.raises(InputError, match="agents: expected single or multi, found 'many'"):
        evaluate_policy(first, *toy, agents="many")


class Liar(WindowObservation):
    """Says that it shows nothing but where an agent is."""

    local_radius = 0


def test_what_is_refused() -> None:
    toy = "toy-4x4-v0"
    with pytest.raises(InputError, match="scenario: did you mean toy-4x4-v0"):
        evaluate_policy(first, "toy-4x4-v1")
    with pytest.raises(InputError, match="split: expected validation or test, found train"):
        evaluate_policy(first, toy, "train")
    far = WindowObservation(radius=2)
    with pytest.raises(InputError, match=r"WindowObservation.local_radius: expected a whole numb"):
        evaluate_policy(first, toy, local=True, observation=far)
    options: dict[str, Any] = {"observation": PaperObservation(), "max_steps": 2}
    assert evaluate_policy(first, toy, "validation", local=0, **options).problems == 20
    with pytest.raises(InputError, match=r"local_radius: expected at most 2, found 3"):
        evaluate_policy(first, "gates-8x7-v0", "validation", local=2)
    for given in ({"render_mode": "human"}, {"mask": {"in_observation": True}}):
        with pytest.raises(InputError, match=r"(render_mode: expected null|mask: expected no key)"):
            evaluate_policy(first, toy, "validation", **given)  # type: ignore[arg-type]
    for local in (-1, "x", None):
        with pytest.raises(InputError, match="local: expected true, false or a number of Gcells"):
            evaluate_policy(first, toy, "validation", local=local)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="split: expected validation or test, found 'tests'"):
        evaluate_policy(first, toy, "tests")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="policy: expected actions that NumPy can read: Can't"):
        evaluate_policy(lambda obs, _: torch.ones(len(obs), requires_grad=True), toy)
    options["observation"] = Liar()
    with pytest.raises(InputError, match=r"Liar.local_radius: expected agents to see no furth"):
        evaluate_policy(first, toy, "validation", local=True, **options)
    with pytest.raises(InputError, match=r"policy: expected \(100,\) integers.*found float"):
        evaluate_policy(lambda obs, _: obs[:, 0], toy, "validation")
    with pytest.raises(InputError, match="policy: expected"):
        evaluate_policy(lambda obs, _: np.zeros(len(obs) - 1, int), toy)
    with pytest.raises(InputError, match=r"policy: expected .* found object"):
        evaluate_policy(lambda *_: [[1], [1, 2]], toy)
    with pytest.raises(InputError, match=r"policy: expected a function of .* found None"):
        evaluate_policy(None, toy)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="actions from 0 to 5, found 6 to 6"):
        evaluate_policy(lambda obs, _: np.full(len(obs), 6), toy)
