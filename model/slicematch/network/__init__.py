"""SliceMatch's network: encoders, and the aggregation of their features to descriptors."""
