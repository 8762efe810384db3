"""The dot: its outline, its model, its fit."""
