"""What learners remember: transitions to learn from again, and rollouts to learn from once."""
