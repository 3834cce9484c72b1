"""Tools for agents by the Model Context Protocol: the library's functions over files in one folder."""
