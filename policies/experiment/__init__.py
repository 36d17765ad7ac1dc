"""Experiments: problem sets × routers × seeds, compared in tables and figures.

What the folder of an experiment holds:

===============================  ===============================================================
config.yaml                      the whole configuration, defaults included
problems/SET/NAME.gr             what is routed
rows/SET/ROUTER[.seedN]/*.json   the rows of what is done, part by part
runs/SET/ROUTER[.seedN]/*/       the run folders of trainings (:mod:`policies.learned.run`)
solutions/SET/NAME.ROUTER[.seedN].solution
results.json, results.csv        all rows
summary.json                     what they say (:mod:`policies.results.statistics`)
figures/                         the paper's figures
===============================  ===============================================================

The work is cut into parts that know nothing of one another; processes take one after the other. A
part is done when its rows are there, so an experiment that was stopped, however, goes on when it is
started again, and does what is new when it is asked for more routers, seeds or sets: all that must
stay are the problems of a set and the options of a router. The results are there as soon as a
router is done with all its problems, of all routers that are. Solutions do not depend on the number
of processes, nor on the stops.
"""

from policies.experiment.config import (
    Entry,
    ExperimentConfig,
    Published,
    Training,
    load_experiment,
    load_sets,
)
from policies.experiment.experiment import Experiment
from policies.experiment.folder import (
    COLUMNS,
    CONFIG,
    RESULTS,
    label,
    problem_file,
    read_results,
    solution_file,
)
from policies.experiment.part import Part
from policies.experiment.study import Study, StudyColumn

__all__ = [
    "COLUMNS",
    "CONFIG",
    "RESULTS",
    "Entry",
    "Experiment",
    "ExperimentConfig",
    "Part",
    "Published",
    "Study",
    "StudyColumn",
    "Training",
    "label",
    "load_experiment",
    "load_sets",
    "problem_file",
    "read_results",
    "solution_file",
]
