//! Luminance, sRGB, named colors.
