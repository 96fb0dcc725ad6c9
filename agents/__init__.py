"""Training, classical controllers and headless evaluation for the flexarm environments."""
