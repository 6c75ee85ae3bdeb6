"""Rendered calibrations with a known result."""
