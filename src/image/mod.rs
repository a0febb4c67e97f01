//! Pixel buffers, and the one way between them and OpenCV.
