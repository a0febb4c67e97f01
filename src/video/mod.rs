//! Decoding, time stamps, orientation and the choice of frames.
