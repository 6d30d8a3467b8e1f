"""What a rig needs of its machine, looked at one area after the other; never imported by the measuring daemon."""
