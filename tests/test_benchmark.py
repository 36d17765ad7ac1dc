"""The benchmark: the order of scores, result files, resuming, the leaderboard."""

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from marouting import InputError
from policies.benchmark.score import Figures, score

FIGURES = st.builds(
    Figures, st.integers(0, 3), st.integers(0, 4) | st.integers(0, 500), st.integers(0, 3000)
)
"""Small numbers often, so that levels agree."""


def sign(x: float) -> int:
    return (x > 0) - (x < 0)


@settings(max_examples=2000, deadline=None)
@given(FIGURES, FIGURES, FIGURES, FIGURES)
def test_scores_are_in_the_order_of_open_nets_overflow_and_wirelength(
    one: Figures, other: Figures, astar: Figures, reference: Figures
) -> None:
    reference, astar = min(reference, astar), max(reference, astar)
    mine, theirs = score(one, astar, reference), score(other, astar, reference)
    assert sign(theirs - mine) == sign((one > other) - (one < other))
    assert -3 < mine < 4


@settings(deadline=None)
@given(FIGURES, FIGURES, FIGURES)
def test_a_score_is_the_share_of_the_way(
    found: Figures, astar: Figures, reference: Figures
) -> None:
    reference, astar = min(reference, astar), max(reference, astar)
    assert score(reference, astar, reference) == 1
    if reference < astar:
        assert score(astar, astar, reference) == 0
        assert sign(score(found, astar, reference)) == sign((found < astar) - (found > astar))
    mine = score(found, astar, reference)
    assert (mine > 1) == (found < reference)


def test_scores_worked_out_by_hand() -> None:
    astar, best = Figures(0, 0, 120), Figures(0, 0, 100)
    assert score(Figures(0, 0, 105), astar, best) == 0.75
    assert score(Figures(0, 0, 140), astar, best) == -0.5
    assert score(Figures(0, 0, 80), astar, best) == 1.5
    # One track too many, and as long as the reference: −1 − (1 + ½) / (2 + ½).
    assert score(Figures(0, 1, 100), astar, best) == pytest.approx(-1.6)
    assert -3 < score(Figures(1, 0, 50), astar, best) < -2
    # Overflow is at stake: the way leads from (5, 95) to (0, 100), ½ of a track for the wirelength.
    astar = Figures(0, 5, 95)
    assert score(Figures(0, 2, 100), astar, best) == pytest.approx((4.75 - 2) / 4.75, abs=1e-12)
    assert 0.9 < score(Figures(0, 0, 110), astar, best) < 1
    # No room: worse is below 0, and in twentieths of the reference.
    assert score(best, best, best) == 1
    assert score(Figures(0, 0, 105), best, best) == -0.5
    assert 1 < score(Figures(0, 0, 99), best, best) < 2


@given(FIGURES, FIGURES)
def test_the_reference_is_no_worse_than_astar(astar: Figures, reference: Figures) -> None:
    assume(reference > astar)
    with pytest.raises(InputError, match="at least as good as A"):
        score(astar, astar, reference)
    assert not math.isnan(score(astar, reference, reference))
