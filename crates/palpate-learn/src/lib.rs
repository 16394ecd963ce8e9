//! Evaluation of maps.
