"""SliceMatch in torch, on slicemask banks."""
