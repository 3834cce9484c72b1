"""One module a kind of experiment: from the wish to a motion from home to home that keeps every limit."""
