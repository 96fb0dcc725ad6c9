"""Models of the arm, references and readings, on which controllers build."""
