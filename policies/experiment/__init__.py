"""Experiments: problem sets × routers × seeds, compared in tables and figures.

The folder of an experiment is described in :mod:`policies.results.experiment_folder`.

The work is cut into independent parts, which a pool of processes takes one after the other. A part
is finished when its rows are on disk. An experiment that was stopped, in whatever way, therefore
continues when it is started again, and asked for more routers, seeds or sets it does only what is
new. Only the problems of a set and the options of a router must stay the same. Whenever a router
has finished all its problems, the results of all finished routers are written. Solutions depend
neither on the number of processes nor on interruptions.
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
from policies.experiment.part import Part

__all__ = [
    "Entry",
    "Experiment",
    "ExperimentConfig",
    "Part",
    "Published",
    "Training",
    "load_experiment",
    "load_sets",
]
