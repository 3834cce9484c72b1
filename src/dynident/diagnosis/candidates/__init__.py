"""What could be missing, and how much better each candidate predicts data that it was not fitted to."""
