"""W of a motion that is only proposed: its columns, its gradient, and the rows of every identification model."""
