"""Work on several processors, and on other machines."""
