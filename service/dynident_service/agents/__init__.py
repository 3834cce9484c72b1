"""The Model Context Protocol: the library's functions as tools of an agent, over files in one folder."""
