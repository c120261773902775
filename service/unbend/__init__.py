"""unbend: recognise shapes however they bend."""
