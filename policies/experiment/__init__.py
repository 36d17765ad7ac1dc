"""Experiments: problem sets × routers × seeds, compared in tables and figures.

A benchmark (:mod:`policies.experiment.benchmark`) is an experiment on the splits of scenarios. The
folder of either:

================================  ==============================================================
config.yaml                       the whole configuration, defaults included
problems/SET/NAME.gr              the problems
rows/SET/ROUTER[.seedN]/*.json    the rows of finished work, part by part
rows/digests.json                 digests of the files and code that the rows depend on
policies/SET/ROUTER[.seedN].json  what is known of a trained policy that was played
runs/SET/ROUTER[.seedN]/*/        the run folders of trainings
solutions/SET/NAME.ROUTER[.seedN].solution
results.json, results.csv         all rows (:mod:`policies.results.rows`)
summary.json, figures/            of an experiment: statistics (:mod:`policies.results.statistics`)
                                  and the paper's figures
SCENARIO.ROUTER.json              of a benchmark: result files (:mod:`policies.experiment.result`)
================================  ==============================================================

The work is cut into independent parts, which a pool of processes takes one after the other. A part
is finished when its rows are on disk. An experiment that was stopped, in whatever way, therefore
continues when it is started again, and asked for more routers, seeds or sets it does only what is
new. Only the problems of a set and the options of a router must stay the same. Whenever a router
has finished all its problems, the results of all finished routers are written. Solutions depend
neither on the number of processes nor on interruptions.
"""

from policies.experiment.config import Entry, ExperimentConfig, load_experiment, load_sets
from policies.experiment.experiment import Experiment

__all__ = ["Entry", "Experiment", "ExperimentConfig", "load_experiment", "load_sets"]
