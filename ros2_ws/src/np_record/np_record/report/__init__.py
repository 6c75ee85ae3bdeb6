"""The report of recorded episodes: plots, video, and the page that every report of the project shares."""
