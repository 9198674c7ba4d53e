"""The paper's own Steps 3 and 4 for Bouc-Wen's law, with earlier results fixed at their means."""
