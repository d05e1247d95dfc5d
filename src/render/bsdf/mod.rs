//! How surfaces scatter light: one file per kind, dispatched by an enum.
