// SPDX-License-Identifier: Apache-2.0
/* An access-control plugin for Cyclone DDS 0.10 that presents another permissions document to its peers than that of its
 * enclave: the file KEYMINT_PRESENTED. KEYMINT_VENDOR_PLUGIN is the path of the vendor's plugin, which does all else. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "dds/security/dds_security_api.h"

#define MOST 1048576

struct ddsi_domaingv;
typedef int (*init_function)(const char *, void **, struct ddsi_domaingv *);
typedef int (*finalize_function)(void *);

static void *vendor;  /* the shared object; stays loaded */
static DDS_Security_access_control_get_permissions_credential_token vendors_token;

static DDS_Security_boolean present(dds_security_access_control *plugin, DDS_Security_PermissionsCredentialToken *token,
                                    const DDS_Security_PermissionsHandle handle, DDS_Security_SecurityException *exception)
{
  if (!vendors_token(plugin, token, handle, exception))
    return false;
  FILE *file = fopen(getenv("KEYMINT_PRESENTED"), "rb");
  char *content = calloc(1, MOST);
  if (!file || !content || fread(content, 1, MOST - 1, file) == 0)
    abort();
  fclose(file);
  for (unsigned i = 0; i < token->properties._length; i++)
    if (strcmp(token->properties._buffer[i].name, "dds.perm.cert") == 0)
    {
      free(token->properties._buffer[i].value);
      token->properties._buffer[i].value = content;
      return true;
    }
  abort();
}

int init_access_control(const char *argument, void **context, struct ddsi_domaingv *gv)
{
  const char *path = getenv("KEYMINT_VENDOR_PLUGIN");
  vendor = path ? dlopen(path, RTLD_NOW | RTLD_LOCAL) : NULL;
  if (!vendor)
    return -1;
  const init_function init = (init_function)dlsym(vendor, "init_access_control");
  const int code = init ? init(argument, context, gv) : -1;
  if (code == 0)
  {
    dds_security_access_control *plugin = *context;
    vendors_token = plugin->get_permissions_credential_token;
    plugin->get_permissions_credential_token = present;
  }
  return code;
}

int finalize_access_control(void *context)
{
  const finalize_function finalize = (finalize_function)dlsym(vendor, "finalize_access_control");
  return finalize ? finalize(context) : -1;
}
