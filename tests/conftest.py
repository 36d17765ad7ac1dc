"""What all test processes have in common."""

import os

# Test processes run side by side: threads of one would be in the way of the others. Libraries read
# this when they are first imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
