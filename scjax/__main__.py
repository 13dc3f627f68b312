"""``python -m scjax``: the command ``scjax``."""

from scjax.cli import main

if __name__ == "__main__":
    main()
