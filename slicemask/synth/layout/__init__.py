"""What stands where in a generated city: streets, blocks and their elements, without pictures."""
