"""Tables of colour for engines that compute in three channels: pictures, and the shaders that read them."""
