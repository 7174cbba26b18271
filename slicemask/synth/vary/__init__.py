"""Domain randomisation: switches that widen what a generated city may look like."""
