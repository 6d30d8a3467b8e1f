"""What is not certain becomes unknown: outliers, components, uniqueness, occlusion conflicts."""
