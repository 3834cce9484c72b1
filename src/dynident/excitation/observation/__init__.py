"""W of a proposed motion: its columns, its gradient, and the rows of every identification model."""
