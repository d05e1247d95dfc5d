//! Laws that hold on average, one module per room.

mod estimators;
