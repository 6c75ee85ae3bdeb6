"""Objects to be moved: what they weigh, how they slide and give way; the rows of the paper's table, and files of one's own."""
