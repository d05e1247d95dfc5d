//! Where camera rays begin.
