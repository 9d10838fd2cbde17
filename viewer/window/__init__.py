"""The window: panes, panel, dialogs, mouse and keyboard."""
