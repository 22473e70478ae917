"""What models share: their base classes, statics, sensitivities and the check for distortion."""
