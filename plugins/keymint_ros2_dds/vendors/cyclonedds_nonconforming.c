// SPDX-License-Identifier: Apache-2.0
/* An access-control plugin for Cyclone DDS 0.10 whose participant ignores its own permissions: its local checks always
 * succeed, and the vendor's plugin does everything else. Peers get its true identity and permissions, and only they can
 * refuse it. KEYMINT_VENDOR_PLUGIN is the path of the vendor's plugin. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>

#include "dds/security/dds_security_api.h"

struct ddsi_domaingv;
typedef int (*init_function)(const char *, void **, struct ddsi_domaingv *);
typedef int (*finalize_function)(void *);

static void *vendor;  /* the shared object; stays loaded */

static DDS_Security_boolean joins(dds_security_access_control *plugin, const DDS_Security_PermissionsHandle handle,
                                  const DDS_Security_DomainId domain, const DDS_Security_Qos *qos,
                                  DDS_Security_SecurityException *exception)
{
  (void)plugin, (void)handle, (void)domain, (void)qos, (void)exception;
  return true;
}

static DDS_Security_boolean has_endpoint(dds_security_access_control *plugin,
                                         const DDS_Security_PermissionsHandle handle,
                                         const DDS_Security_DomainId domain, const DDS_Security_char *topic,
                                         const DDS_Security_Qos *qos, const DDS_Security_PartitionQosPolicy *partition,
                                         const DDS_Security_DataTags *tags, DDS_Security_SecurityException *exception)
{
  (void)plugin, (void)handle, (void)domain, (void)topic, (void)qos, (void)partition, (void)tags, (void)exception;
  return true;
}

static DDS_Security_boolean has_topic(dds_security_access_control *plugin, const DDS_Security_PermissionsHandle handle,
                                      const DDS_Security_DomainId domain, const DDS_Security_char *topic,
                                      const DDS_Security_Qos *qos, DDS_Security_SecurityException *exception)
{
  (void)plugin, (void)handle, (void)domain, (void)topic, (void)qos, (void)exception;
  return true;
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
    plugin->check_create_participant = joins;
    plugin->check_create_datawriter = has_endpoint;
    plugin->check_create_datareader = has_endpoint;
    plugin->check_create_topic = has_topic;
  }
  return code;
}

int finalize_access_control(void *context)
{
  const finalize_function finalize = (finalize_function)dlsym(vendor, "finalize_access_control");
  return finalize ? finalize(context) : -1;
}
