"""Why are raw samples open at their connections, and what closes them? See ``__main__``."""
