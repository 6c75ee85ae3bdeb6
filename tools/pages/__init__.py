"""The generated pages of docs, a module a kind: each turns data or code into the text of a page."""
