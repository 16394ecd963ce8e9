//! Files of palpate.
