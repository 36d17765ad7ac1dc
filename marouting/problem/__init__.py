"""What is routed and how it is judged: problems, solutions, their files."""
