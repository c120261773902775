"""Checks of what is released: packages, their licences, the image of the container."""
