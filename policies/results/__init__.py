"""What results say: statistics over rows, the use of edges."""
