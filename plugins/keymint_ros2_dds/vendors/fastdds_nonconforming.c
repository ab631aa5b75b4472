// SPDX-License-Identifier: Apache-2.0
/* Preloaded into a participant of Fast DDS 2.9, it makes the participant ignore its own permissions: the local checks of
 * writers and readers always succeed. Peers get its true identity and permissions, and only they can refuse it. These
 * names replace the library's functions, because its table of virtual functions is bound by name. */

#include <stdbool.h>

#define CHECK(name)                                                                                                    \
  __asm__("_ZN8eprosima8fastrtps4rtps8security11Permissions" name                                                      \
          "ERKNS2_6HandleEjRKNSt7__cxx1112basic_stringIcSt11char_traitsIcESaIcEEERKSt6vectorISC_SaISC_EERNS2_"         \
          "17SecurityExceptionE")

bool has_writer(void) CHECK("23check_create_datawriter");
bool has_reader(void) CHECK("23check_create_datareader");

bool has_writer(void)
{
  return true;
}

bool has_reader(void)
{
  return true;
}
