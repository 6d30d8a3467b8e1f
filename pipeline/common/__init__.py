"""What every stage may use: errors, settings, compilation, arithmetic on tiles, stopwatch."""
