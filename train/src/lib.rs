//! Checkpoints to model directories; later, training.
