"""The scenes of pictures, and the meshes of users."""
