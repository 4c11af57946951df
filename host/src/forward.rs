//! Scene -> frame: optics, then effects in physical order. (being written)
