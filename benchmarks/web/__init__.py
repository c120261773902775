"""Measurements and pictures of the web page, in a real browser at a real server."""
