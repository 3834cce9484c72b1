"""Conversion between HTTP bodies and the library's requests, and between results and views."""
