"""Procedural worlds: road networks, traffic, bystanders and rare events, with a label for every scene.

``world.make_world`` builds a world: ``network_types`` gives the roads, ``traffic`` and ``bystanders`` the agents,
``events`` the rare events. ``recording`` turns a world into a ``Log``, ``labels`` labels its scenes, and
``source.Worlds`` makes records of them.
"""
