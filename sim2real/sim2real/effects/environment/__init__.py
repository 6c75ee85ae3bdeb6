"""Where the table is, other than it is believed to be."""
