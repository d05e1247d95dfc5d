//! What varies over a surface: colors and numbers.
