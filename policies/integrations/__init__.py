"""What libraries need that options of the environment cannot give: one file for each library.

Each file imports its library, which the package does not bring. docs/libraries.md says what else to
use for which library.
"""
