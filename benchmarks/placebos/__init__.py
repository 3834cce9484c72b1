"""Candidates that cannot be right, since they come at the wrong time: what passes all the same?"""
