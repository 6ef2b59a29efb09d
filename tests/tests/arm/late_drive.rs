//! A drive whose delay grows in the middle of a motion: the arm is braked before it is fast.
