"""The paper's own Steps 3 and 4, with earlier results held at their means, for Bouc-Wen's law."""
