"""Trust in a mission: its certificate authority, identities, the roster of trusted certificates, and access rules.

`authority` issues, renews and revokes; `identity` reads the folder of a process; `roster` lists the certificates whose
signatures count. It imports `schemas`, and knows neither Zenoh nor nodes.

A mission's folder of keys:

    DIR/authority/certificate.pem, key.pem            signs identities and the roster (Ed25519)
    DIR/authority/page-certificate.pem, page-key.pem  signs what browsers see (P-256: browsers take no Ed25519)
    DIR/roster.json                                   every certificate ever issued, and which are revoked; signed
    DIR/identities/ROLE-NAME/                         one folder for each, to be copied to its machine:
        certificate.pem, key.pem                        for TLS and for signatures (Ed25519)
        authority.pem, roster.json                      the trusted certificates; public
        page-certificate.pem, page-key.pem,             people only: for `he3 web` as a server, or for a browser
        page-authority.pem

Folders are 0700, files 0600. The authority's keys are needed to issue, renew and revoke, and nowhere else.
"""
