"""What the resources of the service share: types, routes, conversion of fields, stored inputs of jobs.

A resource has a folder of its own, with `routes` (paths), `wire_types` (bodies and answers), `adapters` (from and to
the library's types) and `jobs` (what child processes compute). Routes import the science where they use it, not at
their top: it takes seconds to load, and the service answers before.
"""
