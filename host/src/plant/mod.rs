//! The simulated plant: dynamics, contact, sensors, error sources, laser tracker.
