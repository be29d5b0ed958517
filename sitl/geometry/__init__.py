"""The simulator's own geometry: quaternions, transforms, NED/FRD conversion, point grid."""
