"""Pictures of a laid out city: its mesh, its surfaces, light, cameras and sensors."""
