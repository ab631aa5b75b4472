# SPDX-License-Identifier: Apache-2.0
"""Judge what lies in a keystore: each rule once, each code raised in one place.

The doors are :func:`check.check` (``keymint check``), :func:`keystore.proven_keystore` with
:func:`keystore.deciding_findings` (``prove``) and :func:`keystore.not_examined` (what the user may not read).
docs/verification.md says which verb reads what. All that judges installed files:

============================================  =======================================================================
here
``check``                                     all findings of a keystore, and of a second one beside it; one enclave:
                                              its key and strays; its build type asks more
``keystore``                                  what ``prove`` asks as well; the register, and revocation lists, against
                                              what is installed
``authorities``                               certificates and keys of authorities, their dates and drift; private keys:
                                              where they are, plain, exposed, in a repository
``rights``                                    what every certificate in force may present, against the policy
``files``                                     modes, owners, links, kinds and records of files; the install space
                                              outside of the enclaves
``adopted_documents``                         signed documents of another tool's keystore, by a policy
``bundles``                                   may a robot take a bundle
``weaknesses``                                what Keymint would have made otherwise: ``keymint harden``
``nodes``                                     what the rules keep from starting
``report_signer``                             who may sign a report: an authority that no robot obeys
below, since stages and the life of keys ask
``keymint.pki.examine``                       certificate, key and authority of an enclave, and its dates; the path
                                              of a certificate (RFC 5280)
``keymint.pki.foreign_authorities``           what the certificate of an authority lacks
``keymint.authority.examine``                 evidence for an authority's key and certificate, and what contradicts it
``keymint.life.examine``                      a key has one owner; rights that stay good; enclaves without sources
``keymint.life.terms``                        what is over, to come, or ends soon
``keymint.life.revocation_lists_in_force``    the list that an enclave must have
``keymint.adoption``                          reads keystores of other tools, and compares them with a policy
a transport's own
``examine``                                   in its plugin: the rules about an enclave's files; views: ``check``,
                                              ``proving``, and what ``keymint adopt`` reads
============================================  =======================================================================
"""
