"""Results as text, Markdown, HTML and pictures; every report and every table on a terminal."""
