"""What the tests of Ray run in its processes: a module that these import in a moment."""

import os
import signal
from pathlib import Path
from typing import Any

from marouting import InputError, Problem, Solution
from marouting.rewards import PaperReward
from policies.routers.astar import AStarRouter


class KilledOnce:
    """A* in a process that is killed the first time.

    Args:
        mark: a file that says that it has been, by its whole path.
        words: a file that must be there.
    """

    def __init__(self, mark: str, words: str) -> None:
        assert Path(words).read_text() == "words\n"
        self.mark = Path(mark)

    def route(self, problem: Problem) -> Solution:
        kill_once(self.mark)
        return AStarRouter().route(problem)


class Refuses:
    """A router that is given a file that it cannot use."""

    def __init__(self, words: str) -> None:
        self.words = words

    def route(self, problem: Problem) -> Solution:
        raise InputError(f"{self.words}: expected numbers, for {problem.grid}")


class LateReward:
    """The paper's, in a process that is killed the first time, after so many moves.

    Args:
        mark: a file that says that it has been, by its whole path.
        moves: how many moves.
        tally: a file for the number of moves paid, in the last process.
    """

    def __init__(self, mark: str, moves: int, tally: str) -> None:
        self.paper, self.paid = PaperReward(), 0
        self.mark, self.moves, self.tally = Path(mark), moves, Path(tally)

    def __call__(self, *arguments: Any) -> Any:
        self.paid += 1
        if self.paid == self.moves and not self.mark.exists():
            kill_once(self.mark)
        if self.paid % 100 == 0:
            self.tally.write_text(str(self.paid))
        return self.paper(*arguments)


def kill_once(mark: Path) -> None:
    """Kills this process unless there is a file, which is there from then on."""
    if not mark.exists():
        mark.write_text(str(os.getpid()))
        os.kill(os.getpid(), signal.SIGKILL)


def total(*numbers: int) -> int:
    return sum(numbers)
