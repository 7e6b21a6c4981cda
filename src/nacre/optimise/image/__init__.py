"""Design of images: parameter maps that reproduce a picture."""
