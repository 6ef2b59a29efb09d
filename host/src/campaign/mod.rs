//! The external controller of the paper: sends poses, hears recordings, stores them.
