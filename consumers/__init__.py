"""Programs of others that open exported files: a virtual environment for each, and checks that run in it.

Their packages exclude each other, so none of them is a dependency of scjax.
"""
