"""What others do: the paper's identification and its peers."""
