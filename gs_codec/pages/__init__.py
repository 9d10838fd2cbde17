"""Results as text, Markdown, HTML and pictures, for all reports and terminal tables."""
