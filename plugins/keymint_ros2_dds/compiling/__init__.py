"""The compiler: from the rules of a subject to the permissions document that is emitted.

In the order of the passes: ``lower`` maps names and says what is allowed and denied; ``plans`` and ``partitions`` make
decision lists of it; ``rules`` puts these into an order that every vendor reads alike; ``spelling`` writes expressions;
``gathering`` and ``priority`` rewrite them. ``compile`` runs these; ``emission`` proves the result, and chooses among
the forms that it may have.
"""
