//! Stadium, cameras, pitches, renderer, noise; truth beside every product.
