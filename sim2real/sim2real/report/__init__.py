"""The result as files: JSON after the schema, and a page."""
