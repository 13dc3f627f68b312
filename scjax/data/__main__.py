"""``python -m scjax.data``: the commands of ``scjax data``."""

if __name__ == "__main__":  # worker processes import this file too, and need no commands
    from scjax.cli.data import main

    raise SystemExit(main())
