"""How exciting a motion is: the criteria, what they need to know, and how well every parameter will come out."""
