"""Attributes of scenes as data: one table of what can be measured and requested. ``table.py`` lists all of them."""
