"""The wiring stage: conventions of a recording that its own physics contradicts, before anything else is diagnosed from it."""
