//! The only room that says `opencv`; no `Mat` leaves it.
