"""What a run is made of: its settings, and the folder that training leaves behind."""
