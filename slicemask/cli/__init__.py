"""The slicemask command: parse, call the library once, print."""
