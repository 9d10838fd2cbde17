"""The ``gs-codec`` command."""
