"""The analytic engine: equations of motion, compiled."""
