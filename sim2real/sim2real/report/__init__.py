"""The answer as files: JSON after the schema, and a page."""
