"""Speed, as ratios measured in one run: ``python -m policies.bench``.

Every figure stands beside a comparator that ran in the same process at the same time, in turns with
it, because a figure alone says as much about the machine as about the code. Each is the median of
several repeats; the best is given too, since whatever else runs on a machine only makes it slower.
"""
