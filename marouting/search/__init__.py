"""What walks the game without learning."""
