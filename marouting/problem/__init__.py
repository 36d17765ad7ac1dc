"""Problems and solutions: what is routed, how it is judged, and the files that hold it."""
