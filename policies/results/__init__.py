"""Results as files on disk and what they say: rows, folders, statistics, use of edges."""
