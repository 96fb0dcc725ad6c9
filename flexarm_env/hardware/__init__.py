"""Between the arm and a controller: actuators, sensors, and the spread of the plant."""
