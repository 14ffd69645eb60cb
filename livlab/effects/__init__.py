"""Effects: which there are in a scene, what each costs and changes, and which the scene calls for.

`config` is what an experiment file says, `catalogue` lists a scene's effects, `plan` chooses among them; nothing is
imported here, since reading a configuration must not wait for solvers.
"""
