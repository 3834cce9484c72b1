"""What a residual shows by itself: where it is large, what it depends on, and where to look for its cause."""
