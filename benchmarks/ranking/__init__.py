"""Tables and studies of ranked controllers."""
