"""What a policy sees: position image, privileged offsets, and the observation that holds them."""
