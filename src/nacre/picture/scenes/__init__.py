"""What stands in a picture: the scenes, and the meshes that users bring."""
