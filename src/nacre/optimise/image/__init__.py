"""Image design: parameter maps that reproduce a picture."""
