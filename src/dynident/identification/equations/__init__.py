"""What an identification is solved from: the equations of its model, reduced from recordings, and their checks."""
