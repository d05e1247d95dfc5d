//! Drawing directions.
